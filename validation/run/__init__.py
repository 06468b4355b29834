"""One walk: in memory, into a folder, and replayed."""
