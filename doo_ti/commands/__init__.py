"""The commands: ``declare`` of a module adds their options to the parser, ``run…`` does the work and returns the exit code. It
takes the parsed options, with the ``words`` of the command line: it checks all input, works, and prints the results. Heavy
modules are imported where they are used, those of public names as ``doo_ti.NAME``, so that wrong input is reported at once.
"""
