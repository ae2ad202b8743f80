"""The page and the HTTP API of a cell: a process of its own, which speaks to the daemon over its socket."""
