"""A simulated ABB controller: Robot Web Services, and tasks that run RAPID."""
