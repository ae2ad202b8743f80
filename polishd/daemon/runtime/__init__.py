"""What all of the daemon runs on: process, log, events, exit record, compute worker."""
