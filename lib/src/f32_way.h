/* The ways of a step of the chain: rdpi_f32_chain_t.usual, .way and rdpi_f32_unlag_t.way. */
#ifndef RDPI_F32_WAY_H
#define RDPI_F32_WAY_H

/* One of the first four is the usual way of a chain. */
enum {
    PLAIN,      /* the operator alone */
    LEAD,       /* the lead before it */
    CREEP,      /* creep^-1 before it */
    LEAD_CREEP, /* both */
    GENERAL,    /* as LEAD or LEAD_CREEP, with no preview, no history, missed samples, or no resonances */
    LAG         /* any of these, in unlag.way, with lag^-1 behind it */
};

#endif
