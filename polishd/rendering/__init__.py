"""How results look: the document model with its HTML and PDF writers, plot style, terminal tables."""
