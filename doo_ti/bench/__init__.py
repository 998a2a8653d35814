"""Throughput and accuracy on this machine: the rods, the clock, the cases, and what a person reads of them."""
