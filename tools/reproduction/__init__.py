"""The tables and figures of the thesis again, from this repository: one module each."""
