"""Audit and figures of the paper."""
