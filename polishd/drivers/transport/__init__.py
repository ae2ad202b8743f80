"""What drivers share: addresses, byte streams, owned background work, a request queue, and a voice coil on any wire."""
