"""Claims about addresses: who hears a request, who answers it, and whom it must not move."""
