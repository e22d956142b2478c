"""Measures how well the whole daemon goes and docks in a simulated room (launcher: tools/evaluate)."""
