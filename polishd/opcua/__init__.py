"""The cell as an OPC UA machine for the systems of a plant: a process apart, a client of the daemon's socket."""
