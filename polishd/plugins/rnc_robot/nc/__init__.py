"""ISO-like NC text (``kind = "nc"``): read by one scanner over all bytes, rewritten number by number."""
