"""Servers for the systems of a plant, each a process of its own and a client of the daemon's socket."""
