"""What the removal map of a pass teaches of the process, how surely, and what it cannot: docs/identification.md."""
