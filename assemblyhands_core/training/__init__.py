"""Training: data sets, what is varied in them, and the loop that all networks share."""
