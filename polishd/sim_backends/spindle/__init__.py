"""The simulated spindle drive: behaviour, CAN frames, slcan and socketcand."""
