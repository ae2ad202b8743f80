"""The daemon of a polishing cell: configuration, plugins, cell, cycle, journal, worker process and service."""
