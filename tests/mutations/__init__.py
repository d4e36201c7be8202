"""Does the suite notice a fault? `python -m tests.mutations` puts faults into a copy of the code and runs the tests."""
