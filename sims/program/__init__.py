"""Terminal, signals, output and arguments, shared by all commands."""
