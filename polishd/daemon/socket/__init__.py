"""The daemon's socket: its server, its client and the commands of both."""
