"""Robots whose controllers load files, over OPC UA, ADS or Modbus: docs/protocols/plc_robot.md."""
