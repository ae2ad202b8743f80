"""The plant without wires and without real time: `docs/protocols/batch_plant.md`."""
