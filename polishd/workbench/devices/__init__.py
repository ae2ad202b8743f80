"""Device profiles, without a cell: what there is, what a profile means, where a device answers."""
