"""What the verbs do at the terminal: tables, progress, and the demo. Nothing here decides anything about a part."""
