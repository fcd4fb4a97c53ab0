"""Parts of the systems that the bench is compared with, written anew from their published constants."""
