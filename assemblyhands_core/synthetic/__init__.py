"""A capture studio in software: people at a table, cameras, pictures and the truth about them."""
