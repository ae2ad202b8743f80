"""Runtime of the daemon: process, log, events, exit record, compute worker."""
