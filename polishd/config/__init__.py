"""Configuration models, one file a kind of file: cell, job, instrument, device, controller, simulator, study."""
