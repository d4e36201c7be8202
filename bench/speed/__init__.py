"""How fast ORCA is: renderer and trainer, fast against reference in one process, with memory and machine."""
