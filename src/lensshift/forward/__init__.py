"""What we assume that the world does: y_k = gain_k (D B M_k x) + bias_k, as linear operators."""
