"""Files and folders: written atomically, read back without loss."""
