"""Our own plugins: hook implementations, declared in the same entry-point group as anybody else's."""
