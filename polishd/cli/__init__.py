"""The command line: options and output, one file for each command group."""
