"""Pictures, pages, recordings and text tables, made from saved records."""
