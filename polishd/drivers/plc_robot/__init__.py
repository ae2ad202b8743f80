"""Robots whose controllers load files, over OPC UA, ADS, Modbus or HSES: docs/protocols/plc_robot.md."""
