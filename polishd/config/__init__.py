"""One TOML loader with places of errors: cell, instrument profile, study."""
