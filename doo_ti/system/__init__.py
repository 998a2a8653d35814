"""What everything stands on: errors, checked arguments, files, the terminal, and the program of Taichi."""
