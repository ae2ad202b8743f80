"""ABB robots by Robot Web Services: the controller runs the program and reports each point by a variable."""
