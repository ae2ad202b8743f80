"""Reports: of a run, of a map, and the certificate of a part."""
