"""One job of the daemon: its records, part handling, tools, map wait and estimates."""
