"""The command line: options, text, exit statuses. No other package imports it.

Commands import what they run: simulator, Pinocchio, NumPy and matplotlib take long to load.
"""
