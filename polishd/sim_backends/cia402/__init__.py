"""A simulated drive of CiA 402 on CANopen, for a spindle or a voice coil: examples/drive.eds describes it."""
