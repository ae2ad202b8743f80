"""The simulated robot controller: its own reader of RNC programs, its own motion, the robot link."""
