"""Loop closing: a vocabulary of descriptors, place recognition, verification of a place, and the pose graph."""
