"""Linear algebra that scipy lacks: ordered sparse factors, the front QR."""
