"""The journal on disk: records, schema, array store, checksums, history."""
