"""Throughput and accuracy on this machine: the rods, the clock, the cases and the table of ``doo-ti bench``."""
