"""Our own firmware in a simulated AVR, with a robot's body round it: for tests, plots and simulated robots.

simavr is under the GPL 3. It is loaded here, in a tool, from the system; nothing in omnibotd or firmware_bridge does.
"""
