"""One module per command: ``declare`` adds its options to the parser, ``run`` does the work and returns the exit code.

``run`` takes the parsed options and the words of the command line: it checks all input, then works, then tells. Heavy modules
are imported where they are used, so that wrong input is told at once.
"""
