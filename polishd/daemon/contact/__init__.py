"""The tool in contact: streaming, force and time checks, interruption, the safe way out."""
