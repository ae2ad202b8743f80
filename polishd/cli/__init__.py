"""The command line: options and printing, one file a command group; it decides nothing."""
