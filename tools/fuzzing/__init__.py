"""Inputs of tools/fuzz.py: valid files of every format, and changes of them."""
