"""Agreement of representations with the exact law: metrics A4 to A14."""
