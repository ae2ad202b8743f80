/PROG  POLISH
/ATTR
COMMENT		= "polishd" ;
/MN
   1:UFRAME_NUM=1 ;
   2:UTOOL_NUM=1 ;
   3:L P[1] 20mm/sec FINE    ;
   4:L P[2] 20mm/sec FINE    ;
   5:L P[3] 20mm/sec FINE    ;
   6:  WAIT   0.50(sec) ;
   7:L P[4] 20mm/sec FINE    ;
   8:  WAIT   0.50(sec) ;
   9:L P[5] 20mm/sec FINE    ;
  10:  WAIT   0.50(sec) ;
  11:L P[6] 20mm/sec FINE    ;
  12:  WAIT   0.50(sec) ;
  13:L P[7] 20mm/sec FINE    ;
  14:  WAIT   0.50(sec) ;
  15:L P[8] 20mm/sec FINE    ;
  16:  WAIT   0.50(sec) ;
  17:L P[9] 20mm/sec FINE    ;
  18:  WAIT   0.50(sec) ;
  19:L P[10] 20mm/sec FINE    ;
  20:  WAIT   0.50(sec) ;
  21:L P[11] 20mm/sec FINE    ;
  22:  WAIT   0.50(sec) ;
  23:L P[12] 20mm/sec FINE    ;
  24:  WAIT   0.50(sec) ;
  25:L P[13] 20mm/sec FINE    ;
  26:  WAIT   0.50(sec) ;
  27:L P[14] 20mm/sec FINE    ;
  28:  WAIT   0.50(sec) ;
  29:L P[15] 20mm/sec FINE    ;
  30:  WAIT   0.50(sec) ;
  31:L P[16] 20mm/sec FINE    ;
  32:  WAIT   0.50(sec) ;
  33:L P[17] 20mm/sec FINE    ;
  34:  WAIT   0.50(sec) ;
  35:L P[18] 20mm/sec FINE    ;
  36:  WAIT   0.50(sec) ;
  37:L P[19] 20mm/sec FINE    ;
  38:  WAIT   0.50(sec) ;
  39:L P[20] 20mm/sec FINE    ;
  40:  WAIT   0.50(sec) ;
  41:L P[21] 20mm/sec FINE    ;
  42:  WAIT   0.50(sec) ;
  43:L P[22] 20mm/sec FINE    ;
  44:  WAIT   0.50(sec) ;
  45:L P[23] 20mm/sec FINE    ;
  46:  WAIT   0.50(sec) ;
  47:L P[24] 20mm/sec FINE    ;
  48:  WAIT   0.50(sec) ;
  49:L P[25] 20mm/sec FINE    ;
  50:  WAIT   0.50(sec) ;
  51:L P[26] 20mm/sec FINE    ;
  52:  WAIT   0.50(sec) ;
  53:L P[27] 20mm/sec FINE    ;
  54:  WAIT   0.50(sec) ;
  55:L P[28] 20mm/sec FINE    ;
  56:  WAIT   0.50(sec) ;
  57:L P[29] 20mm/sec FINE    ;
  58:  WAIT   0.50(sec) ;
  59:L P[30] 20mm/sec FINE    ;
  60:  WAIT   0.50(sec) ;
  61:L P[31] 20mm/sec FINE    ;
  62:  WAIT   0.50(sec) ;
  63:L P[32] 20mm/sec FINE    ;
  64:  WAIT   0.50(sec) ;
  65:L P[33] 20mm/sec FINE    ;
  66:  WAIT   0.50(sec) ;
  67:L P[34] 20mm/sec FINE    ;
  68:  WAIT   0.50(sec) ;
  69:L P[35] 20mm/sec FINE    ;
  70:  WAIT   0.50(sec) ;
  71:L P[36] 20mm/sec FINE    ;
  72:  WAIT   0.50(sec) ;
  73:L P[37] 20mm/sec FINE    ;
  74:  WAIT   0.50(sec) ;
  75:L P[38] 20mm/sec FINE    ;
  76:  WAIT   0.50(sec) ;
  77:L P[39] 20mm/sec FINE    ;
  78:  WAIT   0.50(sec) ;
  79:L P[40] 20mm/sec FINE    ;
  80:  WAIT   0.50(sec) ;
  81:L P[41] 20mm/sec FINE    ;
  82:  WAIT   0.50(sec) ;
  83:L P[42] 20mm/sec FINE    ;
  84:  WAIT   0.50(sec) ;
  85:L P[43] 20mm/sec FINE    ;
  86:  WAIT   0.50(sec) ;
  87:L P[44] 20mm/sec FINE    ;
  88:  WAIT   0.50(sec) ;
  89:L P[45] 20mm/sec FINE    ;
  90:  WAIT   0.50(sec) ;
  91:L P[46] 20mm/sec FINE    ;
  92:  WAIT   0.50(sec) ;
  93:L P[47] 20mm/sec FINE    ;
  94:  WAIT   0.50(sec) ;
  95:L P[48] 20mm/sec FINE    ;
  96:  WAIT   0.50(sec) ;
  97:L P[49] 20mm/sec FINE    ;
  98:  WAIT   0.50(sec) ;
  99:L P[50] 20mm/sec FINE    ;
 100:  WAIT   0.50(sec) ;
 101:L P[51] 20mm/sec FINE    ;
 102:  WAIT   0.50(sec) ;
 103:L P[52] 20mm/sec FINE    ;
 104:  WAIT   0.50(sec) ;
 105:L P[53] 20mm/sec FINE    ;
 106:  WAIT   0.50(sec) ;
 107:L P[54] 20mm/sec FINE    ;
 108:  WAIT   0.50(sec) ;
 109:L P[55] 20mm/sec FINE    ;
 110:  WAIT   0.50(sec) ;
 111:L P[56] 20mm/sec FINE    ;
 112:  WAIT   0.50(sec) ;
 113:L P[57] 20mm/sec FINE    ;
 114:  WAIT   0.50(sec) ;
 115:L P[58] 20mm/sec FINE    ;
 116:  WAIT   0.50(sec) ;
 117:L P[59] 20mm/sec FINE    ;
 118:  WAIT   0.50(sec) ;
 119:L P[60] 20mm/sec FINE    ;
 120:  WAIT   0.50(sec) ;
 121:L P[61] 20mm/sec FINE    ;
 122:  WAIT   0.50(sec) ;
 123:L P[62] 20mm/sec FINE    ;
 124:  WAIT   0.50(sec) ;
 125:L P[63] 20mm/sec FINE    ;
 126:  WAIT   0.50(sec) ;
 127:L P[64] 20mm/sec FINE    ;
 128:  WAIT   0.50(sec) ;
 129:L P[65] 20mm/sec FINE    ;
 130:  WAIT   0.50(sec) ;
 131:L P[66] 20mm/sec FINE    ;
 132:  WAIT   0.50(sec) ;
 133:L P[67] 20mm/sec FINE    ;
 134:  WAIT   0.50(sec) ;
 135:L P[68] 20mm/sec FINE    ;
 136:  WAIT   0.50(sec) ;
 137:L P[69] 20mm/sec FINE    ;
 138:  WAIT   0.50(sec) ;
 139:L P[70] 20mm/sec FINE    ;
 140:  WAIT   0.50(sec) ;
 141:L P[71] 20mm/sec FINE    ;
 142:  WAIT   0.50(sec) ;
 143:L P[72] 20mm/sec FINE    ;
 144:  WAIT   0.50(sec) ;
 145:L P[73] 20mm/sec FINE    ;
 146:  WAIT   0.50(sec) ;
 147:L P[74] 20mm/sec FINE    ;
 148:  WAIT   0.50(sec) ;
 149:L P[75] 20mm/sec FINE    ;
 150:  WAIT   0.50(sec) ;
 151:L P[76] 20mm/sec FINE    ;
 152:  WAIT   0.50(sec) ;
 153:L P[77] 20mm/sec FINE    ;
 154:  WAIT   0.50(sec) ;
 155:L P[78] 20mm/sec FINE    ;
 156:  WAIT   0.50(sec) ;
 157:L P[79] 20mm/sec FINE    ;
 158:  WAIT   0.50(sec) ;
 159:L P[80] 20mm/sec FINE    ;
 160:  WAIT   0.50(sec) ;
 161:L P[81] 20mm/sec FINE    ;
 162:  WAIT   0.50(sec) ;
 163:L P[82] 20mm/sec FINE    ;
 164:  WAIT   0.50(sec) ;
 165:L P[83] 20mm/sec FINE    ;
 166:  WAIT   0.50(sec) ;
 167:L P[84] 20mm/sec FINE    ;
 168:  WAIT   0.50(sec) ;
 169:L P[85] 20mm/sec FINE    ;
 170:  WAIT   0.50(sec) ;
 171:L P[86] 20mm/sec FINE    ;
 172:  WAIT   0.50(sec) ;
 173:L P[87] 20mm/sec FINE    ;
 174:  WAIT   0.50(sec) ;
 175:L P[88] 20mm/sec FINE    ;
 176:  WAIT   0.50(sec) ;
 177:L P[89] 20mm/sec FINE    ;
 178:  WAIT   0.50(sec) ;
 179:L P[90] 20mm/sec FINE    ;
 180:  WAIT   0.50(sec) ;
 181:L P[91] 20mm/sec FINE    ;
 182:  WAIT   0.50(sec) ;
 183:L P[92] 20mm/sec FINE    ;
 184:  WAIT   0.50(sec) ;
 185:L P[93] 20mm/sec FINE    ;
 186:  WAIT   0.50(sec) ;
 187:L P[94] 20mm/sec FINE    ;
 188:  WAIT   0.50(sec) ;
 189:L P[95] 20mm/sec FINE    ;
 190:  WAIT   0.50(sec) ;
 191:L P[96] 20mm/sec FINE    ;
 192:  WAIT   0.50(sec) ;
 193:L P[97] 20mm/sec FINE    ;
 194:  WAIT   0.50(sec) ;
 195:L P[98] 20mm/sec FINE    ;
 196:  WAIT   0.50(sec) ;
 197:L P[99] 20mm/sec FINE    ;
 198:  WAIT   0.50(sec) ;
 199:L P[100] 20mm/sec FINE    ;
 200:  WAIT   0.50(sec) ;
 201:L P[101] 20mm/sec FINE    ;
 202:  WAIT   0.50(sec) ;
 203:L P[102] 20mm/sec FINE    ;
 204:  WAIT   0.50(sec) ;
 205:L P[103] 20mm/sec FINE    ;
 206:  WAIT   0.50(sec) ;
 207:L P[104] 20mm/sec FINE    ;
 208:  WAIT   0.50(sec) ;
 209:L P[105] 20mm/sec FINE    ;
 210:  WAIT   0.50(sec) ;
 211:L P[106] 20mm/sec FINE    ;
 212:  WAIT   0.50(sec) ;
 213:L P[107] 20mm/sec FINE    ;
 214:  WAIT   0.50(sec) ;
 215:L P[108] 20mm/sec FINE    ;
 216:  WAIT   0.50(sec) ;
 217:L P[109] 20mm/sec FINE    ;
 218:  WAIT   0.50(sec) ;
 219:L P[110] 20mm/sec FINE    ;
 220:  WAIT   0.50(sec) ;
 221:L P[111] 20mm/sec FINE    ;
 222:  WAIT   0.50(sec) ;
 223:L P[112] 20mm/sec FINE    ;
 224:  WAIT   0.50(sec) ;
 225:L P[113] 20mm/sec FINE    ;
 226:  WAIT   0.50(sec) ;
 227:L P[114] 20mm/sec FINE    ;
 228:  WAIT   0.50(sec) ;
 229:L P[115] 20mm/sec FINE    ;
 230:  WAIT   0.50(sec) ;
 231:L P[116] 20mm/sec FINE    ;
 232:  WAIT   0.50(sec) ;
 233:L P[117] 20mm/sec FINE    ;
 234:  WAIT   0.50(sec) ;
 235:L P[118] 20mm/sec FINE    ;
 236:  WAIT   0.50(sec) ;
 237:L P[119] 20mm/sec FINE    ;
 238:  WAIT   0.50(sec) ;
 239:L P[120] 20mm/sec FINE    ;
 240:  WAIT   0.50(sec) ;
 241:L P[121] 20mm/sec FINE    ;
 242:  WAIT   0.50(sec) ;
 243:L P[122] 20mm/sec FINE    ;
 244:  WAIT   0.50(sec) ;
 245:L P[123] 20mm/sec FINE    ;
 246:  WAIT   0.50(sec) ;
 247:L P[124] 20mm/sec FINE    ;
 248:  WAIT   0.50(sec) ;
 249:L P[125] 20mm/sec FINE    ;
 250:  WAIT   0.50(sec) ;
 251:L P[126] 20mm/sec FINE    ;
 252:  WAIT   0.50(sec) ;
 253:L P[127] 20mm/sec FINE    ;
 254:  WAIT   0.50(sec) ;
 255:L P[128] 20mm/sec FINE    ;
 256:  WAIT   0.50(sec) ;
 257:L P[129] 20mm/sec FINE    ;
 258:  WAIT   0.50(sec) ;
 259:L P[130] 20mm/sec FINE    ;
 260:  WAIT   0.50(sec) ;
 261:L P[131] 20mm/sec FINE    ;
 262:  WAIT   0.50(sec) ;
 263:L P[132] 20mm/sec FINE    ;
 264:  WAIT   0.50(sec) ;
 265:L P[133] 20mm/sec FINE    ;
 266:  WAIT   0.50(sec) ;
 267:L P[134] 20mm/sec FINE    ;
 268:  WAIT   0.50(sec) ;
 269:L P[135] 20mm/sec FINE    ;
 270:  WAIT   0.50(sec) ;
 271:L P[136] 20mm/sec FINE    ;
 272:  WAIT   0.50(sec) ;
 273:L P[137] 20mm/sec FINE    ;
 274:  WAIT   0.50(sec) ;
 275:L P[138] 20mm/sec FINE    ;
 276:  WAIT   0.50(sec) ;
 277:L P[139] 20mm/sec FINE    ;
 278:  WAIT   0.50(sec) ;
 279:L P[140] 20mm/sec FINE    ;
 280:  WAIT   0.50(sec) ;
 281:L P[141] 20mm/sec FINE    ;
 282:  WAIT   0.50(sec) ;
 283:L P[142] 20mm/sec FINE    ;
 284:  WAIT   0.50(sec) ;
 285:L P[143] 20mm/sec FINE    ;
 286:  WAIT   0.50(sec) ;
 287:L P[144] 20mm/sec FINE    ;
 288:  WAIT   0.50(sec) ;
 289:L P[145] 20mm/sec FINE    ;
 290:  WAIT   0.50(sec) ;
 291:L P[146] 20mm/sec FINE    ;
 292:  WAIT   0.50(sec) ;
 293:L P[147] 20mm/sec FINE    ;
 294:  WAIT   0.50(sec) ;
 295:L P[148] 20mm/sec FINE    ;
 296:  WAIT   0.50(sec) ;
 297:L P[149] 20mm/sec FINE    ;
 298:  WAIT   0.50(sec) ;
 299:L P[150] 20mm/sec FINE    ;
 300:  WAIT   0.50(sec) ;
 301:L P[151] 20mm/sec FINE    ;
 302:  WAIT   0.50(sec) ;
 303:L P[152] 20mm/sec FINE    ;
 304:  WAIT   0.50(sec) ;
 305:L P[153] 20mm/sec FINE    ;
 306:  WAIT   0.50(sec) ;
 307:L P[154] 20mm/sec FINE    ;
 308:  WAIT   0.50(sec) ;
 309:L P[155] 20mm/sec FINE    ;
 310:  WAIT   0.50(sec) ;
 311:L P[156] 20mm/sec FINE    ;
 312:  WAIT   0.50(sec) ;
 313:L P[157] 20mm/sec FINE    ;
 314:  WAIT   0.50(sec) ;
 315:L P[158] 20mm/sec FINE    ;
 316:  WAIT   0.50(sec) ;
 317:L P[159] 20mm/sec FINE    ;
 318:  WAIT   0.50(sec) ;
 319:L P[160] 20mm/sec FINE    ;
 320:  WAIT   0.50(sec) ;
 321:L P[161] 20mm/sec FINE    ;
 322:  WAIT   0.50(sec) ;
 323:L P[162] 20mm/sec FINE    ;
 324:  WAIT   0.50(sec) ;
 325:L P[163] 20mm/sec FINE    ;
 326:  WAIT   0.50(sec) ;
 327:L P[164] 20mm/sec FINE    ;
 328:  WAIT   0.50(sec) ;
 329:L P[165] 20mm/sec FINE    ;
 330:  WAIT   0.50(sec) ;
 331:L P[166] 20mm/sec FINE    ;
 332:  WAIT   0.50(sec) ;
 333:L P[167] 20mm/sec FINE    ;
 334:  WAIT   0.50(sec) ;
 335:L P[168] 20mm/sec FINE    ;
 336:  WAIT   0.50(sec) ;
 337:L P[169] 20mm/sec FINE    ;
 338:  WAIT   0.50(sec) ;
 339:L P[170] 20mm/sec FINE    ;
/POS
P[1]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -10.1912 mm,	Y = 8.0709 mm,	Z = 20.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.53282 deg
};
P[2]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -10.1912 mm,	Y = 8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.53282 deg
};
P[3]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.8436 mm,	Y = 8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.53346 deg
};
P[4]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.4960 mm,	Y = 8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.53409 deg
};
P[5]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.1483 mm,	Y = 8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.53472 deg
};
P[6]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.8007 mm,	Y = 8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.53535 deg
};
P[7]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.4531 mm,	Y = 8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.53598 deg
};
P[8]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.1054 mm,	Y = 8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.53661 deg
};
P[9]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.7578 mm,	Y = 8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.53723 deg
};
P[10]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.5898 mm,	Y = 8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.53786 deg
};
P[11]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.9375 mm,	Y = 8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.53848 deg
};
P[12]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.2851 mm,	Y = 8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.53910 deg
};
P[13]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.6327 mm,	Y = 8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.53971 deg
};
P[14]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.9803 mm,	Y = 8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.54033 deg
};
P[15]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.9803 mm,	Y = 6.7257 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.61694 deg
};
P[16]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.6609 mm,	Y = 6.7257 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.61644 deg
};
P[17]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.3414 mm,	Y = 6.7257 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.61593 deg
};
P[18]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.0219 mm,	Y = 6.7257 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.61543 deg
};
P[19]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.7024 mm,	Y = 6.7257 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.61492 deg
};
P[20]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.6171 mm,	Y = 6.7257 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.61441 deg
};
P[21]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.9366 mm,	Y = 6.7257 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.61390 deg
};
P[22]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.2561 mm,	Y = 6.7257 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.61339 deg
};
P[23]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.5755 mm,	Y = 6.7257 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.61288 deg
};
P[24]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.8950 mm,	Y = 6.7257 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.61236 deg
};
P[25]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.2145 mm,	Y = 6.7257 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.61185 deg
};
P[26]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.2145 mm,	Y = 5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.68948 deg
};
P[27]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.8273 mm,	Y = 5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.68991 deg
};
P[28]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.4401 mm,	Y = 5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.69034 deg
};
P[29]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.0529 mm,	Y = 5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.69077 deg
};
P[30]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.6658 mm,	Y = 5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.69120 deg
};
P[31]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.2786 mm,	Y = 5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.69163 deg
};
P[32]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.1086 mm,	Y = 5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.69206 deg
};
P[33]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.4958 mm,	Y = 5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.69249 deg
};
P[34]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.8830 mm,	Y = 5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.69291 deg
};
P[35]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.2702 mm,	Y = 5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.69333 deg
};
P[36]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.6574 mm,	Y = 5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.69376 deg
};
P[37]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.0446 mm,	Y = 5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.69418 deg
};
P[38]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.0446 mm,	Y = 4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.77063 deg
};
P[39]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.6585 mm,	Y = 4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.77032 deg
};
P[40]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.2724 mm,	Y = 4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.77000 deg
};
P[41]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.8863 mm,	Y = 4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.76968 deg
};
P[42]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.5002 mm,	Y = 4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.76936 deg
};
P[43]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.1141 mm,	Y = 4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.76904 deg
};
P[44]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.2720 mm,	Y = 4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.76872 deg
};
P[45]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.6581 mm,	Y = 4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.76840 deg
};
P[46]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.0441 mm,	Y = 4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.76808 deg
};
P[47]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.4302 mm,	Y = 4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.76776 deg
};
P[48]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.8163 mm,	Y = 4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.76743 deg
};
P[49]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.2024 mm,	Y = 4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.76711 deg
};
P[50]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.5885 mm,	Y = 4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.76678 deg
};
P[51]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.5885 mm,	Y = 2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.84452 deg
};
P[52]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.2433 mm,	Y = 2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.84473 deg
};
P[53]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.8981 mm,	Y = 2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.84494 deg
};
P[54]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.5529 mm,	Y = 2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.84515 deg
};
P[55]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.2078 mm,	Y = 2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.84536 deg
};
P[56]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.8626 mm,	Y = 2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.84557 deg
};
P[57]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.5174 mm,	Y = 2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.84578 deg
};
P[58]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.8278 mm,	Y = 2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.84599 deg
};
P[59]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.1730 mm,	Y = 2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.84619 deg
};
P[60]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.5182 mm,	Y = 2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.84640 deg
};
P[61]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.8634 mm,	Y = 2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.84660 deg
};
P[62]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.2085 mm,	Y = 2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.84681 deg
};
P[63]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.5537 mm,	Y = 2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.84701 deg
};
P[64]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.8989 mm,	Y = 2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.84722 deg
};
P[65]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.8989 mm,	Y = 1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.92361 deg
};
P[66]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.5221 mm,	Y = 1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.92350 deg
};
P[67]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.1452 mm,	Y = 1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.92340 deg
};
P[68]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.7684 mm,	Y = 1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.92329 deg
};
P[69]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.3916 mm,	Y = 1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.92319 deg
};
P[70]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.0147 mm,	Y = 1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.92308 deg
};
P[71]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.6379 mm,	Y = 1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.92298 deg
};
P[72]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.7390 mm,	Y = 1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.92287 deg
};
P[73]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.1158 mm,	Y = 1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.92277 deg
};
P[74]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.4926 mm,	Y = 1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.92266 deg
};
P[75]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.8695 mm,	Y = 1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.92255 deg
};
P[76]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.2463 mm,	Y = 1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.92244 deg
};
P[77]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.6232 mm,	Y = 1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.92234 deg
};
P[78]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -9.0000 mm,	Y = 1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -89.92223 deg
};
P[79]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -9.0000 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[80]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.6154 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[81]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.2308 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[82]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.8462 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[83]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.4615 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[84]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.0769 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[85]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.6923 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[86]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.6923 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[87]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.0769 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[88]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.4615 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[89]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.8462 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[90]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.2308 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[91]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.6154 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[92]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 9.0000 mm,	Y = 0.0000 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.00000 deg
};
P[93]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 9.0000 mm,	Y = -1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.07638 deg
};
P[94]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.6232 mm,	Y = -1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.07649 deg
};
P[95]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.2463 mm,	Y = -1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.07659 deg
};
P[96]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.8695 mm,	Y = -1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.07670 deg
};
P[97]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.4926 mm,	Y = -1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.07680 deg
};
P[98]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.1158 mm,	Y = -1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.07691 deg
};
P[99]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.7390 mm,	Y = -1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.07701 deg
};
P[100]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.6379 mm,	Y = -1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.07712 deg
};
P[101]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.0147 mm,	Y = -1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.07723 deg
};
P[102]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.3916 mm,	Y = -1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.07733 deg
};
P[103]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.7684 mm,	Y = -1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.07744 deg
};
P[104]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.1452 mm,	Y = -1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.07755 deg
};
P[105]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.5221 mm,	Y = -1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.07766 deg
};
P[106]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.8989 mm,	Y = -1.3451 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.07776 deg
};
P[107]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.8989 mm,	Y = -2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.15553 deg
};
P[108]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -7.5537 mm,	Y = -2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.15532 deg
};
P[109]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.2085 mm,	Y = -2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.15511 deg
};
P[110]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.8634 mm,	Y = -2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.15490 deg
};
P[111]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.5182 mm,	Y = -2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.15469 deg
};
P[112]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.1730 mm,	Y = -2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.15448 deg
};
P[113]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.8278 mm,	Y = -2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.15427 deg
};
P[114]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.5174 mm,	Y = -2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.15406 deg
};
P[115]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.8626 mm,	Y = -2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.15386 deg
};
P[116]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.2078 mm,	Y = -2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.15365 deg
};
P[117]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.5529 mm,	Y = -2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.15344 deg
};
P[118]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.8981 mm,	Y = -2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.15324 deg
};
P[119]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.2433 mm,	Y = -2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.15303 deg
};
P[120]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.5885 mm,	Y = -2.6903 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.15283 deg
};
P[121]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.5885 mm,	Y = -4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.22924 deg
};
P[122]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.2024 mm,	Y = -4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.22956 deg
};
P[123]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.8163 mm,	Y = -4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.22988 deg
};
P[124]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.4302 mm,	Y = -4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.23019 deg
};
P[125]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.0441 mm,	Y = -4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.23051 deg
};
P[126]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.6581 mm,	Y = -4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.23083 deg
};
P[127]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.2720 mm,	Y = -4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.23115 deg
};
P[128]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.1141 mm,	Y = -4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.23147 deg
};
P[129]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.5002 mm,	Y = -4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.23179 deg
};
P[130]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.8863 mm,	Y = -4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.23211 deg
};
P[131]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.2724 mm,	Y = -4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.23244 deg
};
P[132]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.6585 mm,	Y = -4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.23276 deg
};
P[133]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.0446 mm,	Y = -4.0354 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.23309 deg
};
P[134]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -8.0446 mm,	Y = -5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.31078 deg
};
P[135]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -6.6574 mm,	Y = -5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.31035 deg
};
P[136]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.2702 mm,	Y = -5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.30992 deg
};
P[137]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.8830 mm,	Y = -5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.30948 deg
};
P[138]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.4958 mm,	Y = -5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.30905 deg
};
P[139]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.1086 mm,	Y = -5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.30862 deg
};
P[140]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.2786 mm,	Y = -5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.30820 deg
};
P[141]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.6658 mm,	Y = -5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.30777 deg
};
P[142]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.0529 mm,	Y = -5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.30734 deg
};
P[143]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.4401 mm,	Y = -5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.30692 deg
};
P[144]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.8273 mm,	Y = -5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.30650 deg
};
P[145]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.2145 mm,	Y = -5.3806 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.30607 deg
};
P[146]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.2145 mm,	Y = -6.7257 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.38259 deg
};
P[147]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 5.8950 mm,	Y = -6.7257 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.38309 deg
};
P[148]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.5755 mm,	Y = -6.7257 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.38360 deg
};
P[149]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.2561 mm,	Y = -6.7257 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.38410 deg
};
P[150]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 1.9366 mm,	Y = -6.7257 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.38461 deg
};
P[151]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.6171 mm,	Y = -6.7257 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.38511 deg
};
P[152]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.7024 mm,	Y = -6.7257 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.38562 deg
};
P[153]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -2.0219 mm,	Y = -6.7257 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.38613 deg
};
P[154]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.3414 mm,	Y = -6.7257 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.38664 deg
};
P[155]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.6609 mm,	Y = -6.7257 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.38715 deg
};
P[156]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.9803 mm,	Y = -6.7257 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.38767 deg
};
P[157]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -5.9803 mm,	Y = -8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.46520 deg
};
P[158]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -4.6327 mm,	Y = -8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.46457 deg
};
P[159]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -3.2851 mm,	Y = -8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.46394 deg
};
P[160]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -1.9375 mm,	Y = -8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.46332 deg
};
P[161]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = -0.5898 mm,	Y = -8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.46269 deg
};
P[162]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 0.7578 mm,	Y = -8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.46207 deg
};
P[163]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 2.1054 mm,	Y = -8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.46145 deg
};
P[164]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 3.4531 mm,	Y = -8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.46083 deg
};
P[165]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 4.8007 mm,	Y = -8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.46021 deg
};
P[166]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 6.1483 mm,	Y = -8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.45959 deg
};
P[167]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 7.4960 mm,	Y = -8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.45898 deg
};
P[168]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 8.8436 mm,	Y = -8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.45836 deg
};
P[169]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 10.1912 mm,	Y = -8.0709 mm,	Z = 0.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.45775 deg
};
P[170]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X = 10.1912 mm,	Y = -8.0709 mm,	Z = 20.0000 mm,
	W = -165.00000 deg,	P = 0.00000 deg,	R = -90.45775 deg
};
/END
