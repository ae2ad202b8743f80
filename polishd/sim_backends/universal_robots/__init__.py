"""A simulated Universal Robots controller: scripts, RTDE, dashboard, and a tool that moves as they say."""
