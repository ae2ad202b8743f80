"""G-code text (`kind = "nc"`): one scanner over all bytes, and a rewriter number by number."""
