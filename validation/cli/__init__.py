"""The command line: options, text, exit statuses. No other package imports it."""
