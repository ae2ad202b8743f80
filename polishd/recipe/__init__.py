"""The computing steps of a cycle, and the records that they leave behind."""
