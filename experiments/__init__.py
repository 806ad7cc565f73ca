"""The paper's figures, and claims of our own: `python -m experiments fig4 -o out/fig4`."""
