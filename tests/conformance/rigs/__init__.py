"""Every driver on every link, each against a peer that speaks the documented protocol over a real socket or terminal.

A rig for another peer (a simulator, a real machine) is another function here: the suites know nothing else of it.
"""
