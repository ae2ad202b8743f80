"""Files, threads, compiled functions, secrets, wire recording: what knows nothing of polishing."""
