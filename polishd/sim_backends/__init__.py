"""The simulated cell: machines that speak the real wire protocols, each a process, and their plant.

Nothing in polishd imports this package. Of polishd it imports ``model`` and ``config.simulator`` only: the robots'
mechanics, removal law, map writer, program reader and link codecs are its own, so that the controller is not tested
against its mirror image.
"""
