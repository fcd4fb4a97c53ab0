"""For maintainers: what ``make docs`` makes itself: reference pages from the code, links that hold on the site."""
