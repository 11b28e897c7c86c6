"""What every web server here needs: authentication, files of a page, safe headers, addresses."""
