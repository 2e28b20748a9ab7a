"""Maps of β against γ: what is asked for, what is run, how it is drawn and where it is kept."""
