"""What a robot's sensors read, and estimators that make its state from that."""
