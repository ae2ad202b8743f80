"""What drivers share: addresses, byte streams, owned background work and a request queue."""
