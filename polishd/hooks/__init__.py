"""Plugins: found, checked, and called so that none takes others down."""
