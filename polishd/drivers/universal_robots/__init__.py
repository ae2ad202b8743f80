"""Universal Robots: docs/protocols/universal_robots.md. The program is sent as URScript and tracked over RTDE."""
