"""The worlds a network learns in: each task is a module, or a package, of its name."""
