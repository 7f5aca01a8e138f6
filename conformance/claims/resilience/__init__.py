"""Claims about a drive that goes on hearing and obeying whatever came before."""
