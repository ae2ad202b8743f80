"""A simulated PLC that loads programs from a folder, and offers its variables over OPC UA or ADS."""
