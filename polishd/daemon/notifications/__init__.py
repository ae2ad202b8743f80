"""Notifications of the daemon: which event is sent, to whom, and the sender."""
