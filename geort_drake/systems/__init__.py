"""Drake LeafSystems, one per file."""
