"""Pages that say what a run found and how: one HTML file each, which needs no network."""
