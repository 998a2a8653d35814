"""Benchmarks: workloads, the clock, and what they are compared with."""
