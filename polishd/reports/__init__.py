"""Reports: run report, map report, and the certificate of a part. Each is a function from facts to a document."""
