"""Universal Robots: docs/protocols/universal_robots.md. The program goes up as URScript and is followed over RTDE."""
