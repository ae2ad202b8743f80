"""Universal Robots, sent as URScript and watched over RTDE (docs/protocols/universal_robots.md)."""
