"""The certificate of a part: its content, PDF and JSON, and the signature over both."""
