"""Inputs on which methods fail: what each does with them, in a process of its own, against a stated expectation."""
