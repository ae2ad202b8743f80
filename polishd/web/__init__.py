"""The page and the HTTP API of a cell: a process apart, a client of the daemon's socket."""
