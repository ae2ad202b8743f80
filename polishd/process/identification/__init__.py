"""What the removal map of a pass teaches of the process, how surely, and what it cannot tell: docs/identification.md."""
