"""Robots whose controllers load files, over OPC UA, ADS or Modbus: docs/protocols/handover.md."""
