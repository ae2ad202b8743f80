"""The controller of a cell: cycle, state machine, job runner, assembly and checks."""
