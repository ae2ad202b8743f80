"""Pictures of the page for the documentation: a frozen cell, a browser, and the scenes that are photographed."""
