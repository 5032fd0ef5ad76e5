"""Take the weights of SVEgoNet that are shipped, or of one's own."""

from stages._shipped_weights import shipped_weights_stage

STAGE = shipped_weights_stage("use_svegonet", "SVEgoNet", "train_ego")
