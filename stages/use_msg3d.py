"""Take the weights of MSG3D that are shipped, or of one's own."""

from stages._shipped_weights import shipped_weights_stage

STAGE = shipped_weights_stage("use_msg3d", "MSG3D", "verb_weights")
