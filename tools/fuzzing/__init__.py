"""What tools/fuzz.py feeds to the commands: good files of every format, and what is done to them."""
