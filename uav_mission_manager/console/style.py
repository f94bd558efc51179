"""The page's style: light and dark, for sunlight and for eyes that tell red and green badly.

Blue is the vehicle and the manager, orange a warning, vermilion danger, and grey what is not known
or old (Okabe and Ito's colours). Whatever a colour says, a word says too.
"""

from __future__ import annotations

from uav_mission_manager.console.map_overlay import OVERLAY_STYLE
from uav_mission_manager.console.timeline import TIMELINE_STYLE
from uav_mission_manager.drawing.base_map import MAP_STYLE

COLOURS = """
:root{--paper:#fff;--ground:#fff;--ink:#11100e;--dim:#5d5a52;--line:#c9c5ba;--stale:#8a8780;
--craft:#005a9c;--good:#00724f;--warning:#e69f00;--danger:#c43a00;--low:#f0c419;--high:#c43a00;
--fault:#8b4a78;--on-warning:#11100e}
body.body--dark{--paper:#14161a;--ground:#22262c;--ink:#f4f2ec;--dim:#aaa69a;--line:#3d424a;
--stale:#8a8780;--craft:#56b4e9;--good:#2fbf8f;--warning:#e69f00;--danger:#f0642d;--low:#f0e442;
--high:#f0642d;--fault:#cc79a7}
"""

LAYOUT = """
body{background:var(--paper);color:var(--ink);font:16px/1.35 system-ui,sans-serif}
.nicegui-content{padding:0!important;gap:0!important;align-items:stretch!important}
.console{display:grid;height:100vh;gap:8px;padding:8px;box-sizing:border-box;width:100%;
grid-template-columns:minmax(0,2fr) minmax(0,1fr);
grid-template-rows:auto auto minmax(0,1fr) auto;
grid-template-areas:"head head" "tiles tiles" "map side" "time log"}
.console.with-drawer{grid-template-columns:minmax(0,2fr) minmax(0,1fr) 19rem;
grid-template-areas:"head head head" "tiles tiles tiles" "map side drawer" "time log drawer"}
.area-head{grid-area:head;display:flex;gap:8px;align-items:stretch}.area-head>:first-child{flex:1}
.area-tiles{grid-area:tiles;display:flex;gap:5px 8px;flex-wrap:wrap;max-height:6.6rem;
overflow-y:auto}.area-map{grid-area:map}
.area-side{grid-area:side;overflow-y:auto}.area-time{grid-area:time;display:flex;min-width:0}
.area-log{grid-area:log;overflow-y:auto;max-height:11.5rem}
.area-drawer{grid-area:drawer;overflow-y:auto;display:none;flex-direction:column;gap:.5rem}
.with-drawer .area-drawer{display:flex}
.box{border:1px solid var(--line);border-radius:6px;padding:8px;background:var(--paper)}
.area-map{position:relative;padding:0}.area-map>div{position:absolute;inset:0}
.area-map svg{width:100%;height:100%}
.time-scroll{overflow-x:auto;direction:rtl;flex:1;min-width:0}
.time-scroll>div{direction:ltr;display:flex;width:max-content;
margin-right:auto}
.time-scroll svg{display:block}.timeline-names{padding:19px 8px 0 0;white-space:pre}
@media (max-width:1100px){.console{grid-template-columns:minmax(0,1.2fr) minmax(0,1fr)}
.console.with-drawer{grid-template-columns:minmax(0,1fr) minmax(0,1fr) 15rem}
.authority .word,.now .headline{font-size:1.8rem!important}.value{font-size:1.25rem!important}}
@media (max-width:720px){.console,.console.with-drawer{height:auto;
grid-template-columns:minmax(0,1fr);grid-template-rows:auto;
grid-template-areas:"head" "tiles" "side" "map" "drawer" "time" "log"}.area-map{height:60vw}
.top{flex-wrap:wrap}}
"""

PARTS = """
.top{display:flex;gap:8px;align-items:stretch}.vehicle{font-size:1.5rem;font-weight:700;
align-self:center;overflow-wrap:anywhere}
.fact,.authority{display:flex;flex-direction:column;padding:2px 10px;border-left:3px solid
var(--line);min-width:5.5rem}.label{font-size:.8rem;color:var(--dim)}
.value{font-size:1.5rem;font-weight:700;line-height:1.15}.note{font-size:.85rem;color:var(--dim)}
.authority{flex:1;min-width:13rem;border:0;border-radius:6px;background:var(--good);color:#fff}
.body--dark .authority.good{color:#0b0d10}
.authority .label,.authority .note{color:inherit}.authority .word{font-size:2.1rem;font-weight:800;
line-height:1.05;letter-spacing:.02em}
.authority .note{display:-webkit-box;-webkit-line-clamp:2;-webkit-box-orient:vertical;
overflow:hidden}
.authority.warning{background:var(--warning);color:var(--on-warning)}
.authority.danger{background:var(--danger)}.authority.stale{background:var(--stale)}
.warning .value,.tile .warning{background:var(--warning);color:var(--on-warning);padding:0 .3em;
border-radius:4px}
.danger .value,.tile .danger{background:var(--danger);color:#fff;padding:0 .3em;border-radius:4px}
.danger .value{animation:blink 1s step-end infinite}
@keyframes blink{50%{background:transparent;color:var(--danger)}}
@media (prefers-reduced-motion:reduce){.danger .value{animation:none}}
.stale .value,.tile .stale{color:var(--stale)}
.tile{display:flex;gap:.6em;border:2px solid var(--line);border-radius:6px;padding:0 8px;
cursor:pointer;align-items:baseline}.tile.selected{border-color:var(--craft)}
.tile .word{font-weight:800}
.playback{display:flex;gap:1rem;align-items:center;flex:1 0 100%;padding:0 8px}
.playback .scrubber{flex:1}.differences{display:block;
width:100%;height:8px;fill:var(--warning);background:var(--ground)}
.playback .time{font-variant-numeric:tabular-nums;font-weight:600}
.now .headline{font-size:2.3rem;font-weight:800;line-height:1.08;color:var(--craft);
overflow-wrap:anywhere}.now.stale .headline,.now.stale .reason{color:var(--stale)}
.now.idle .headline{color:var(--dim);font-weight:600}
.now.danger .headline{color:var(--danger)}
.now .reason{font-size:1.25rem;font-weight:600}.now .second,.now .share{font-size:1.05rem}
.other{margin-top:.5rem;border-left:5px solid var(--line);padding-left:.5rem}
.other .headline{font-weight:700}.other.differs{border-color:var(--warning)}
.other.differs .headline{font-size:1.3rem}.other .reason{font-weight:600}
.now .close{font-size:1.05rem;font-weight:600}.now .close.good{color:var(--good)}
.now .close.idle{color:var(--dim);font-weight:400}
h2{font-size:.85rem!important;font-weight:400;color:var(--dim);margin:.5rem 0 .15rem;
line-height:1.2!important}
.bar{display:grid;grid-template-columns:minmax(0,12.5rem) minmax(3rem,1fr) 4.2rem;gap:.5rem;
align-items:center;line-height:1.3}.bar .name{overflow:hidden;
text-overflow:ellipsis;white-space:nowrap}
.bar .track{height:.8rem;background:color-mix(in srgb,var(--line) 40%,transparent);
border-radius:3px}.bar .fill{display:block;height:100%;background:var(--dim);border-radius:3px}
.bar.choice{font-weight:800;color:var(--craft)}.bar.choice .name::before{content:"\\25b6\\a0"}
.bar.second .fill{background:var(--warning)}.bar .amount{text-align:right;
font-variant-numeric:tabular-nums}.rest{color:var(--dim);font-size:.8rem;margin:.15rem 0 0;
line-height:1.25}
.forecast table{border-collapse:collapse;font-variant-numeric:tabular-nums}
.forecast td,.forecast th{padding:0 .7em 0 0;text-align:right;font-weight:600}
.forecast th{font-weight:400;color:var(--dim)}.forecast td:first-child{text-align:left}
.log{list-style:none;margin:0;padding:0;font-size:.9rem}.log li{display:flex;gap:.6em}
.log time{color:var(--dim);font-variant-numeric:tabular-nums}.log .warning span{font-weight:700}
.log .danger span{font-weight:700;color:var(--danger)}
.obstacle{color:var(--danger);font-weight:700}
.area-map .base-text{fill:var(--ink)}
.body--dark .ground{fill:#22262c}.body--dark .base{fill:#24405f}.body--dark .service{fill:#43345f}
.body--dark .zone{fill:#5e3527}.body--dark .calm{fill:#2b3d2b}.body--dark .line{stroke:#3d424a}
.body--dark .area-map text{fill:var(--ink)}.body--dark text.sign{fill:#fff}
.body--dark text.halo{fill:#14161a;stroke:#14161a}.body--dark .north{fill:var(--ink)}
.body--dark .scale,.body--dark .fence{stroke:var(--ink)}
.area-map .round{stroke:var(--dim)}.area-map .waypoint{fill:var(--dim)}
.body--dark .no-fly{fill:#c79ad8;stroke:#c79ad8}
"""

PAGE_STYLE = '\n'.join((MAP_STYLE, COLOURS, LAYOUT, PARTS, OVERLAY_STYLE, TIMELINE_STYLE))
"""All of it."""
