"""Reports of runs and maps, and the certificate of a part, each a function from facts to a document."""
