"""The simulated voice-coil actuator: behaviour, and the two protocols that it speaks."""
