"""Faults, injected: jobs that are killed at every write point and run again, and the table of what was lost."""
