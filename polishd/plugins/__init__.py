"""Hook implementations of this project, declared in the entry-point group that other plugins use."""
