# For CPack: files get the modes that they have in the repository, whatever the umask of the checkout was.
execute_process(COMMAND chmod -R u+rwX,go=rX "${CPACK_TEMPORARY_DIRECTORY}" COMMAND_ERROR_IS_FATAL ANY)
