"""Any device that a profile describes, simulated by a reading of the profile that is not the controller's."""
