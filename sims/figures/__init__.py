"""The paper's figures, each from a run of the real thing: drawn, tabled and said in numbers."""
