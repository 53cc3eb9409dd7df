"""How a star's beam is sampled: its outline, points inside, and orders found by trial."""
