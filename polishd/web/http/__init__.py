"""The HTTP server of page and shop: connections, users, sessions, limits, TLS certificates."""
