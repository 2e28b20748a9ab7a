"""Terminal, signals, output and arguments: what every command shares."""
